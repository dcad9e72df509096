"""The command line of mapfusion."""
