"""Contact laws: built-in ones, dispatch to compiled code, laws by users and their validation."""
