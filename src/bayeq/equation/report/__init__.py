"""The report: one HTML page with the answer, its pictures and how to get it again, which loads nothing.

page       the whole page
page.html  its template
page.css   its style sheet: for wide and narrow screens, and for print
page.js    its script, which draws the live pictures
pictures   which pictures, as images for print and live with hover values
"""
