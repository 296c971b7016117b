"""`python -m polemap`: the console command."""

from polemap.tools.cli import main

main()
