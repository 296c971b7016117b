"""Which sensor is at fault, and how an estimator goes on without it."""
