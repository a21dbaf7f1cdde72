# What the user is told of his set-up when klippy is ready, and where he can see it.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

# How often (s) it is looked whether somebody has begun to listen to the console, and
# for how long after klippy is ready: Moonraker does so 0.8 s later, where both
# are started at once much later.
LISTEN_INTERVAL = 2.0
LISTEN_TIME = 600.0


# The notes of one section: on the console when klippy is ready, and once more as soon
# as somebody has begun to listen; as warnings of the configuration where the host
# has these; in the status.
class Notes:
    # 'read' returns them, when klippy is ready; empty ones are none.
    def __init__(self, host, read):
        self.host = host
        self.read = read
        self.texts = []
        self.is_looking = False
        # Who has heard them, and when to give up (eventtime)
        self.heard = []
        self.end = 0.0
        host.printer.register_event_handler("klippy:ready", self.begin)

    def begin(self):
        self.add([text for text in self.read() if text])

    # Some may be known later
    def add(self, texts):
        if not texts:
            return
        self.texts = self.texts + texts
        for text in texts:
            self.host.say(text)
            self.host.warn(text)
        reactor, eventtime = (
            self.host.printer.get_reactor(),
            self.host.eventtime(),
        )
        self.end = eventtime + LISTEN_TIME
        if not self.is_looking:
            self.is_looking, self.heard = True, self.host.listeners()
            reactor.register_timer(self.look, eventtime + LISTEN_INTERVAL)

    def say(self):
        for text in self.texts:
            self.host.say(text)

    # Of the reactor
    def look(self, eventtime):
        is_new = [c for c in self.host.listeners() if c not in self.heard]
        if is_new:
            self.say()
        if is_new or eventtime > self.end:
            self.is_looking = False
            return self.host.printer.get_reactor().NEVER
        return eventtime + LISTEN_INTERVAL
