"""The version of cosim."""

__version__ = "0.3.0"
