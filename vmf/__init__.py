"""Learn the visuomotor function and turn pixel errors into one position command."""

__version__ = "0.1.0"
