"""Rate-and-state friction: laws, spring and slider, closed forms, stability, fits; knows nothing of grains."""
