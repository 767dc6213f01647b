"""The page and what it carries in itself: pictures, videos, heat maps, scripts."""
