"""The participant's screen: what is shown, and which keys and clicks become which acts."""
