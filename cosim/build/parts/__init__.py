"""Parts of a simulation, those that others of its process have made among them."""
