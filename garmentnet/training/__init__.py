"""Training of networks on a store of clips."""
