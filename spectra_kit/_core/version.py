"""The version, readable where the package runs from its source tree, uninstalled."""

VERSION = "0.3.0"
