"""The classifiers of this package, and how models are read and written."""
