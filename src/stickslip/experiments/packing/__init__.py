"""Reports on one packing: stability, details, and the page written by `stickslip report`."""
