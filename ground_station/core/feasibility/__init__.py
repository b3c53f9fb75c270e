"""What a drone can bring, by the energy model that it flies with."""
