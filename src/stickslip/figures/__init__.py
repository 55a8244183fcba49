"""Results into figures, and nothing else: every function takes a result and returns a Figure."""
