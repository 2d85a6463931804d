"""From detections and labels to average precision. Pure functions over arrays; no network, no disk but `detections`."""

VERSION = 1  # raised whenever the same detections and labels give another AP
MISSING = ("skip", "empty")  # a frame without a result file: left out, or nothing was found in it
