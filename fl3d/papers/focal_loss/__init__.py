"""Yun, Tai, Wang, Liu, Liu: Focal Loss in 3D Object Detection. IEEE Robotics and Automation Letters, 2019."""
