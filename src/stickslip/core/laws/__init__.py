"""Contact laws: built-in laws, dispatch to compiled code, user-defined laws and their validation."""
