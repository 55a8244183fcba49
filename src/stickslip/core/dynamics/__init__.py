"""Time integration: driver, loop, cell motion, records, energy ledger."""
