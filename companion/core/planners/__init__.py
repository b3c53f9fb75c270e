"""SER, RER, GER, BER as published and ours, behind one small interface."""
