// The scripts of others, which are bundled without their types.
declare module "/vendor/*";
