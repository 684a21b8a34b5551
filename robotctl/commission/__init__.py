"""Commissioning: properties of a base, measured from the recording of three short motions."""
