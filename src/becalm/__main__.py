"""Run the command line as `python -m becalm`."""

from becalm.cli.main import main

main()
