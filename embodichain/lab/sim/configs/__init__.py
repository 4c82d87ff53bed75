"""Parts of a scene's config, as pure data; `lab.sim.cfg` exports them."""
