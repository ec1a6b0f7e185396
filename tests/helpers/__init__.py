"""What tests and benchmarks share: motions, models, naive twins, measures, cases."""
