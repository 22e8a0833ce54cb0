"""The native step and its derivatives as torch functions."""
