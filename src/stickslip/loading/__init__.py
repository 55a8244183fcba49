"""What the laboratory does to a sample: builds it, loads it, lets it go."""
