"""A running LAMMPS simulation, watched: measures of each frame, a table, a live page and the terminal."""
