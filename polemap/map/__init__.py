"""The pole map: landmarks, file formats, cities."""
