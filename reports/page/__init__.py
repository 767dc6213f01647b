"""The page with everything it carries: pictures, videos, heat maps, scripts."""
