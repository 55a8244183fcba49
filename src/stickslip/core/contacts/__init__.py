"""One contact: geometry, mechanics, forces, rolling, neighbour lists, Jacobian."""
