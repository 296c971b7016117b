"""Inputs held against each other before work begins; `check.check_drive` shows the whole."""
