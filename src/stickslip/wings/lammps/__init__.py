"""LAMMPS as an engine: a State becomes its input, it runs in processes of its own, and its restart files become States.

`supported` says what LAMMPS cannot do, `cell` and `script` write the input of a leg, and `run` runs it.
`data.exchange.lammps_restart` reads and writes restart files, which hold the memory of contacts exactly.
"""
