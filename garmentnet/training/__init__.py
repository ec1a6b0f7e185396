"""From a store of clips to trained networks."""
