"""What both variants share; knows neither points nor planes."""
