"""From the command line to typed settings and built objects."""
