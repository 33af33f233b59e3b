"""What is given: plant, its uncertainty, the truth, the population of plants, the drive."""
