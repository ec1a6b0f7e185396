"""The motion networks of Pan et al. 2022, their ensemble and their checkpoints."""
