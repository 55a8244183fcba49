"""Contacts: forces, rolling, neighbour lists, Jacobian."""
