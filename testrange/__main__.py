"""`python -m testrange` is the command `testrange`."""

from testrange.cli import main

main()
