"""Wings: packages built on the laboratory; each is imported on first use."""
