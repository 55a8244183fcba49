"""LAMMPS as an engine: a State is written as LAMMPS input, and restart files are read as States.

`supported` checks if LAMMPS can run the conditions; it and `script` write the input of a leg, and `run` runs it.
`data.exchange.lammps_restart` reads and writes restart files, which contain the exact memory of contacts.
"""
