"""What is not known of a car, fitted to logs of it."""
