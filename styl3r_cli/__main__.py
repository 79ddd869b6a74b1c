"""`python -m styl3r_cli`, the same as `styl3r`."""

from styl3r_cli.main import main

main()
