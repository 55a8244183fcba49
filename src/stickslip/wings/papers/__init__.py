"""Disk arrays, sheared spheres, quasi-rigid packings and gouge: four papers, with their claims."""
