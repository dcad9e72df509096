"""`python -m mapfusion_cli`."""

from mapfusion_cli.main import run

run()
