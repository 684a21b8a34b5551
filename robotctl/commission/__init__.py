"""Commissioning: what three short motions tell about a base, measured from their recording."""
