"""The figures and tables of Spangenberg (2016), made on simulated routes by both configurations."""
