"""Style sheet, script and template of the report page."""
