"""Words that everything uses: errors, checks of arguments, threads, signals."""
