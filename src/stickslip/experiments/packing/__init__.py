"""Reports on one packing: stability, details, and the page that `stickslip report` writes."""
