"""What goes to disk and comes from it: scenarios and archives."""
