"""Reads a page as a browser would, as far as tests ask."""

from html.parser import HTMLParser


class PageReader(HTMLParser):
    """What a page would load, run and show."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.addresses: list[str] = []
        self.tags: list[str] = []
        self.texts: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.addresses += [
            value for name, value in attrs if name in {"src", "href", "srcset", "data", "action"}
        ]

    def handle_data(self, data):
        self.texts.append(data.strip())
