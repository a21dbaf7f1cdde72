"""A simulated printer to play with: a page of its own, before a real Moonraker.

Needs tornado, and what hosts/moonraker.py needs: pip install 'simprinter[play]'.
"""
