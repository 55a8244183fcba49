"""LAMMPS as an engine: a State is written as its input, and its restart files are read as States.

`supported` checks the conditions that LAMMPS can run, `cell` and `script` write the input of a leg, and `run` runs it.
`data.exchange.lammps_restart` reads and writes restart files, which contain the exact memory of contacts.
"""
