"""Sources of the compiled core, and the script that builds it."""
