"""A user's own cloth simulations and the skeletons that drove them, as a store of clips."""
