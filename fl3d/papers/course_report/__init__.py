"""Udhayakumar, Das, Gandhi, Price: a course report on PointRCNN and Frustum ConvNet, 2020."""
