"""Wings are packages that build on the rest of stickslip; each is imported on first use."""
