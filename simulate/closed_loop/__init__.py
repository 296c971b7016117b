"""Controllers of `vehicle/control` on the plant, fed by the estimators of `vehicle/estimators`."""
