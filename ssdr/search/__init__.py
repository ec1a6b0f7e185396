"""Search for the best model: a descent and its steps, schedules, changes that are tried."""
