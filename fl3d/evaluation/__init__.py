"""From detections and labels to average precision. Pure functions over arrays; no network, no disk but `detections`."""

VERSION = 1  # raised whenever the same detections and labels give another AP
MEANS = 2  # the same of means over several classes alone: one class has none
MISSING = ("skip", "empty")  # a frame without a result file: left out, or nothing was found in it
