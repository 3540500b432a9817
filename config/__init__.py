"""What a test is: scene models, palletising-file readers, shipped scenes, the material library."""
