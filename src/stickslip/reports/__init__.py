"""What a person reads: the terminal, tables of claims, and reports on one packing."""
