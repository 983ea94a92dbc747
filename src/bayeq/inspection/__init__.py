"""What is in a record or a file: `info`, before anything is inferred.

info       the summary, `RecordInfo`, and how it is made
contents   what it holds
timing     which column is time, which counts experiments, where one ends
channels   numbers of each channel
spectrum   power by frequency
samples    spikes, stuck and clipped stretches
links      which channel is the derivative of another
dynamics   which channel is a first-order state, which one drives a motion
roles      which channel is displacement, velocity, acceleration, force
proposal   the command to run next
together   the same for several files
remarks    what was noticed, a sentence each
text       all that as text and HTML
"""
