"""Which sources this package was built from; the FMU build writes the content's hash here."""

VERSION = "0.1.0"
SOURCES = "unbuilt"
