"""How far apart engines are, in three levels: one state, one step, the same commands without feedback.

Everything here speaks to engines through the contract alone, so an engine of a third party is measured like ours.
It lives beside the replay of recorded commands, among the controllers, because commands are what levels two and
three are measured along; the engines come by name.
"""
