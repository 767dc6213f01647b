"""The page and its parts: pictures, videos, heat maps, scripts."""
