"""PointNet++ on tensors: ``operators`` choose and group points, ``network`` learns features of them."""
