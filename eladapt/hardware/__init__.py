"""Running a controller on a robot: the loop, its timing, and a robot at the other end of a socket."""
