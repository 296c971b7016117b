"""Electric-vehicle work on the vehicle core: estimators, controllers, signal logs, studies."""
