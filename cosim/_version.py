"""The version of cosim."""

__version__ = "0.1.0"
