"""Laws of the textbooks, to be compared with: one law, one file.

They know what the robust law knows (g_n and theta as the plant states them), measure all states and
feed the reference forward along the trajectory Pi Y of the plant's own chain.
"""
