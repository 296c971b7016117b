"""Tables, figures and the page of the repeatability report."""
