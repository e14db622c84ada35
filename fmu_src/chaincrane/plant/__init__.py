"""The cranes: nonlinear and linear, with the same interface. Nothing here knows of control."""
