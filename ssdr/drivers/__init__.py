"""One checked problem, solved in memory or streamed: problem, schedule, drivers."""
