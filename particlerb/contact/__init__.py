"""Contact between particles with a radius: laws, and what follows from them in closed form."""
