//! All that concerns a pair: match, triangulate, electronic vergence, compose for a display.
