"""What writes docs/play.html, a drive to play by hand: ``python -m docs._pages.play``."""
