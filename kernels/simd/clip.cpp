// Body of clip in arithmetic.py.
const run least = *runs(&low), most = *runs(&high);
run r = *runs(&x);
r = r < least ? least : r;  // NaN stays NaN
r = r > most ? most : r;
return as_value(r);
