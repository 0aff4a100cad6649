"""`python -m mpf_core` is the `mpf` command."""

from mpf_core.cli import main

main()
