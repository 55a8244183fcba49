"""LAMMPS as an engine: a State is written as LAMMPS input, and restart files are read as States.

`supported` checks whether LAMMPS can run a leg (part of a run), `script` writes its input, and `run` runs it.
`data.exchange.lammps_restart` reads and writes restart files, which contain the exact memory of contacts.
"""
