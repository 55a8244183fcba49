"""Four papers and their claims: disk arrays, sheared spheres, quasi-rigid packings and gouge."""
