"""Messages to the organiser: kept with the change that they are about, then delivered."""
