"""Import of a user's own cloth simulations and skeletons as a store of clips."""
