"""Solution of a checked problem, in memory or streamed: the problem, schedules, drivers."""
