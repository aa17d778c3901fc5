// Body of clip in arithmetic.py.
const run least = *runs(&low), most = *runs(&high);
run r = *runs(&x);
r = r > least ? r : least;
r = r < most ? r : most;
return as_value(r);
