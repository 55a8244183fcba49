"""Contacts: geometry, mechanics, forces, rolling, neighbour lists, Jacobian."""
