"""In which order the solver's steps are taken, for how long, and what is kept of them."""
