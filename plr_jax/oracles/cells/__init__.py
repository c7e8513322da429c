"""What `VisibilityGraph` knows of whole cells: free pieces, the sources that their points may use, sight of them."""
