"""The pages that lay the thesis' results and ours side by side, made from kept runs alone."""
