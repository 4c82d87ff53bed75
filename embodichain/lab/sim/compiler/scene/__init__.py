"""What is in a scene beside robots: objects, furniture, terrain, the world's file, its look."""
