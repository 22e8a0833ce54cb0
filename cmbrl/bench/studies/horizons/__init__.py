"""Where exact gradients fail: long horizons, stiff contact, chaotic starts."""
