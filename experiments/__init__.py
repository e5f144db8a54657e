"""The command line, protocols, tables and figures."""
