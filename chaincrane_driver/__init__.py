"""Drives the cranes' FMUs with FMPy: runs scenarios, compares models, checks references, draws.

It sees an FMU as any tool does, by its file alone; the models are not imported here.
"""
