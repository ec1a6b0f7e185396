"""The four parts of Pan et al. 2022: bones, low and high frequencies, ensemble; and training."""
