"""The version of cosim."""

__version__ = "0.2.0"
