"""One trade-off: speed against accuracy, where reducers fail, and the simplest that suffices.

`measure` makes one tidy frame; `judge` decides from that frame alone; `page` draws and phrases what was decided. So no
part of the page can contradict another: there is one measurement and one decision behind all of it.
"""
