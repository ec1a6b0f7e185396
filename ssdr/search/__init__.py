"""Order and number of the solver's steps, changes of a model, and the best model so far."""
