"""Commissioning: what two short motions tell about a base, measured from their recording."""
